"""What a mechanism is and how it is written down; no kinematics."""
