"""Who may do what: API keys and tokens, the callers who bring them, and the log of what they changed."""
