"""The commands, a module for each that belong together; imported when they are asked for."""
