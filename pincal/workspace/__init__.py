"""Which poses a mechanism reaches, with margins from singularities."""
