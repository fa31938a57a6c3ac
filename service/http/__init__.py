"""The HTTP side: routes, schemas, uploads, and what stands around every request."""
