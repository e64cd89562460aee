"""Molecules, residues and their templates, independent of file formats."""
