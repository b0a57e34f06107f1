"""Data model: mechanisms, legs, platforms, sensors and measurements; no kinematics."""
