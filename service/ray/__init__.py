"""The worker pool on Ray: `pool` is what the service calls, `remote` what runs in Ray's processes, `cluster` Ray itself."""
