"""Compiled loops over batches of points; imported when a program first runs one."""
