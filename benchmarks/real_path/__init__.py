"""A real path on one machine: two network namespaces and a slow cable between them."""
