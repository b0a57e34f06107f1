"""What the build of the site does before and while Sphinx reads the pages."""
