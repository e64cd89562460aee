"""Side chains: built from ideal geometry, and packed by their rotamers."""
