"""What all parts share: units, errors, checks, settings, storage, compilation, processes."""
