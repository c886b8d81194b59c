"""The command line: parse, call, write; nothing else.

Begin with `cli` (exit codes, signals), then `app` (the subcommands by name) and one file for each: `states`,
`score`, `view`, `map`, `plot`. May import every room, and no room imports it.
"""
