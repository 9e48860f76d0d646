"""The programs that JAX has compiled, kept on the disk between runs."""

import os
import warnings
from pathlib import Path

import jax


def use_compilation_cache() -> None:
    """Keep compiled programs between runs, in $JAX_COMPILATION_CACHE_DIR or the user's cache folder."""
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")  # it only costs time
    if jax.config.values["jax_compilation_cache_dir"] is None:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(home / "invdyn" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.01)  # a command has a hundred small programs
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
