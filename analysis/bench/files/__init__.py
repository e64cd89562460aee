"""Files that people bring, and damaged ones: how they are made, what becomes of them, and how it is judged.

:mod:`.file_kinds` and :mod:`.fate` serve ``benchmarks/kinds.py``, :mod:`.damage` and :mod:`.judge`
``benchmarks/fuzz.py``. :mod:`.recipes` has the parts that both use.
"""
