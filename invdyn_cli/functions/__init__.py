"""The verbs as Python functions: they take objects, and return results that display themselves in a notebook
(docs/python.md). No config; files are written only by `result.save(folder)`. `invdyn_cli/__init__.py` says what the top
level of the package offers.
"""
