"""Tables of rows: what columns and units mean, measurements and plans read and written."""
