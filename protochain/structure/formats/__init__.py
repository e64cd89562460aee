"""Parsers and writers of structure files as gemmi models, without decisions about the structure."""
