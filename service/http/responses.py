"""OpenAPI responses of routes: an answer, and the problems that a path may answer with."""

from typing import Any

from pydantic import BaseModel

from panoloc.service.http.openapi import accepted_headers
from panoloc.service.problems import error_responses

Responses = dict[int | str, dict[str, Any]]


def json_response(model: type[BaseModel], example: Any, *errors: int) -> Responses:
    """Return JSON with status 200. errors: statuses of problems."""
    return {200: {"model": model, "content": {"application/json": {"example": example}}}, **error_responses(*errors)}


def accepted_response(model: type[BaseModel], example: Any, description: str, path_of: str, *errors: int) -> Responses:
    """Return JSON with status 202. path_of: the name of what `Location` leads to."""
    content = {"application/json": {"example": example}}
    accepted = {"model": model, "description": description, "headers": accepted_headers(path_of), "content": content}
    return {202: accepted, **error_responses(*errors)}


def file_response(description: str, media_types: tuple[str, ...], *errors: int) -> Responses:
    """Return bytes of one of these media types with status 200."""
    content = {kind: {"schema": {"type": "string", "format": "binary"}} for kind in media_types}
    return {200: {"description": description, "content": content}, **error_responses(*errors)}


def nothing_left(*errors: int) -> Responses:
    """Return the answer to a deletion, with status 204."""
    return {204: {"description": "Everything of it is deleted."}, **error_responses(*errors)}
