"""The verbs as Python functions: objects in, results out that show themselves (docs/python.md). No config; files are
written only by `result.save(folder)`. `invdyn_cli/__init__.py` says what the top level of the package offers.
"""
