"""Does a margin know who falls? Margins against outcomes of whole-body simulation: ROC curves, tables, figures (V-C to V-E).

`python -m reference.evaluation` makes all of them from the campaign's files. Margins come from the program `jaxcap`, run as
a process of its own: this package never imports it.
"""
