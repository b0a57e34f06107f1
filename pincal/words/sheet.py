"""What the columns of a measuring sheet mean."""

from __future__ import annotations

#: Heads of the table of columns.
HEADS = ("column", "fill in", "what it is")
#: Who fills a column in, by whether it is to be measured.
FILL_IN = {True: "yes", False: "no"}
ROW = "number of the pose, in the order of measuring"
SET = "'all': for the calibration; 'verify': for its check, by poses that it has not seen"
PLANNED = "where to drive the platform: {name}"
DRIVEN = "what {name} reads there by the drawing: drive to it if the machine takes no poses"
MEASURED = "{name} as measured, in the base frame; leave the column empty if it is not measured"
READ = "what the machine reads at joint {joint} of {leg}, {counted}; needed in every row"
COUNTED = {
    True: "counted from the home pose",
    False: "with the zero of the drawing",
}
"""From where a reading counts, by whether its sensor is zeroed at home."""
