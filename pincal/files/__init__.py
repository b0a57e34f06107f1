"""What is read and written: mechanism folders, tables, URDF, YAML."""
