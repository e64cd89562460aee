"""Predicted and damaged models made clean, the fold kept."""
