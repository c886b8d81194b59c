"""The paper's own algorithm and two oracles: NumPy, SciPy and ProxQP, float64, one state at a time.

Del Prete, Tonneau, Mansard, "Zero Step Capturability for Legged Robots in Multi Contact", IEEE T-RO 34(4), 2018,
doi 10.1109/TRO.2018.2820687; equation and algorithm numbers in this package are that paper's, its printed slips are in
`ERRATA.md`. This package is what `jaxcap` is tested against, and imports nothing of it but `jaxcap.engine`, which hands the
campaign's samples to processes and knows nothing of robots, and its errors.
"""
