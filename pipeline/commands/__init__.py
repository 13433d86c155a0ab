"""Commands of `python -m pipeline`: each module here is one.

A module is named as its command (with `_` at the end where Python reserves the word), and has
`add_arguments(parser)` and `run(arguments)`, which returns the exit status. Its docstring's first
line is the command's help. What takes long to import is imported by `run`.
"""
