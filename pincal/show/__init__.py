"""How results look: tables for the terminal, plots."""
