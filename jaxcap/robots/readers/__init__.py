"""Bytes to fields: one file a format. What the fields mean, a layout says.

Begin with `formats`. Every reader gives, for each file, a dictionary from the names of fields (nested ones joined by `/`) to
what they hold: arrays whose first axis are the rows, numbers, texts, or tuples of texts. Arrays may lie in a file: they are
read where they are sliced, so that memory does not grow with the log.
"""
