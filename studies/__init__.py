"""The papers as studies that anybody can run: every number measured, every figure drawn."""
