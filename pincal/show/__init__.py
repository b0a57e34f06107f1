"""How results look: tables, plots, pictures, pages."""
