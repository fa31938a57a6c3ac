"""The HTTP contract as pydantic models: requests, which are validated with them, and responses.

The answer to a query is `panoloc.service.answer.Localization`, which workers build.
"""
