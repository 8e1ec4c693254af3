"""Settings: their definitions, their files, and quantities with units."""
