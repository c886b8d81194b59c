"""Numbers: guarded functions, a bounded loop, a small simplex method. No word of robots.

Begin with `guarded` (roots and divisions that meet zero, and every tolerance), then `simplex_basis` and `simplex`. Imports
no other room.
"""
