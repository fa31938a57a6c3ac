"""What `panoloc bench` does once its options are known: the parts of `core.benchmark`, and those that need a service."""
