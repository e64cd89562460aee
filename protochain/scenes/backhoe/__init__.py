"""A backhoe on the ground."""
