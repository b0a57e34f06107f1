"""Colours that legs and sets are told apart by."""

#: Okabe and Ito's colours, distinct in every common colour-blindness.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
