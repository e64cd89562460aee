"""Side chains: built from ideal geometry, packed by their rotamers, and turned out of one another's way."""
