"""How work is kept and shared: the cache by content, hashes of code."""
