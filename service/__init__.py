"""The service around `core`: HTTP API, worker pool, Redis cache, storage, metrics, command line."""
