"""Importing this module switches jax to 64 bit: in float32 the singular values that decide a rank are lost. What
computes imports it; `types`, `log` and what only describes do not."""

import jax

jax.config.update("jax_enable_x64", True)
