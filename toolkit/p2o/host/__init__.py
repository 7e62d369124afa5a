"""The plugin host: slots, methods, options, the registry, and the guard around every stage."""
