"""Output of results: columns and records, provenance, tables, figures, pages and the viewer.

It uses structures for the viewer, and is independent of the methods that compute results.
"""
