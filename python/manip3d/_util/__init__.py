"""General helpers that know nothing of 3D content: argument checks, options, files, processes."""
