"""Files to and from gemmi's models; nothing is decided here."""
