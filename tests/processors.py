"""What differs from one processor to the next."""

from numpy._core._multiarray_umath import __cpu_features__

ROUNDS_AS_THEN = bool(__cpu_features__.get("AVX512_SKX"))
"""The campaign's files were made where LAPACK (OpenBLAS) has code for AVX-512. It rounds otherwise elsewhere, and pushes,
which hit-and-run makes of the last digit, are then others."""
