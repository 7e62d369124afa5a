"""The process that p2o runs in: processor cores, memory, compiled packages, threads and lazy imports."""
