"""Many states: blocks for cores and devices, chunks for the cache, two rounds for each block.

Begin with `score`, then `rounds` (how a block is answered) and `blocks` (how rows are cut and run side by side).
`kept_programs` and `kept_executables` keep what was compiled for later processes; `devices` and `exported` are for several
devices and for processes without jaxcap. May import what stands above: `numerics`, `contacts`, `one_state`.
"""
