"""Molecules, residues and their templates; no file is known here."""
