"""Residual blocks: what legs demand, what was measured, and what is unknown outside a mechanism."""
