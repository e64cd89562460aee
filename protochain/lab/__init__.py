"""The laboratory of studies and scenes: cases and how they are judged, what they cost, tables and pictures.

:mod:`.cases` holds values against oracles and judges extremes, :mod:`.cost` times calls, :mod:`.report` draws
and writes, :mod:`.made` says where results come from. It knows neither proteins nor mechanics.
"""
