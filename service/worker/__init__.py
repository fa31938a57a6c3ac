"""The work itself: answering a query, registering a scan. Knows nothing of Ray and of HTTP."""
