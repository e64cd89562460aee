"""Decisions about a file's molecules, from the choice of an assembly to the hydrogens."""
