"""States and contacts in files, scores beside them: Parquet, NPZ, YAML, JSON; whole or not at all.

Begin with `records` (open, write), then `columns` (what a state file holds) and `fields` (what an answer is made of:
the table that all descriptions take their words from). `contact_files` and `contact_columns` are the contacts. May
import the rooms of the mathematics: `numerics` to `regions`, and `regions`.
"""
