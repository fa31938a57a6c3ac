"""ASGI middleware that stands before the routes: slow clients, hosts and origins, rates and the queue."""
