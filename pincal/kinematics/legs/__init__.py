"""One leg and all legs: their chains in Pinocchio, their closure, closed at poses."""
