"""The command line: parse, call, write; nothing else.

Begin with `cli` (exit codes, signals), then `app` (the subcommands by name) and one file for each: `states`,
`score` (with `score_file` and `score_folder`: one file, or many), `view` (with `view_row`, what is drawn, and `view_window`,
where), `map`, `plot`. `where` are the options of a job for many processes. May import every room, and no room imports it.
"""
