from invdyn_cli import precision as precision
