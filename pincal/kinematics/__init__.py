"""Closure, inverse and forward kinematics, singularities and derivatives, in batches."""
