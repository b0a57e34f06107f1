"""Workspaces: the poses that a mechanism reaches, with margins from singularities."""
