"""What results are told by: columns and records, provenance, tables, figures, pages and the viewer.

It knows structures, whose looks it shows, and nothing of how a result was made.
"""
