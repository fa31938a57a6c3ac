"""The body of every error."""

from pydantic import Field

from panoloc.service.answer import ResponseModel


class FieldMistake(ResponseModel):
    """One wrong field of the options, or one wrong part of the form."""

    field: str = Field(examples=["hints.radius_m"])
    message: str = Field(examples=["Input should be greater than 0, got -1"])


class ProblemDocument(ResponseModel):
    """A problem document (RFC 9457)."""

    type: str = Field(description="Stable URI of the kind of problem, relative to the service.")
    title: str = Field(description="The kind of problem, for people.")
    status: int = Field(ge=400, le=599)
    detail: str = Field(description="What was expected, what came and what to do.")
    request_id: str = Field(description="The service's log has details under this id.")
    fields: list[FieldMistake] | None = Field(
        None, description="Wrong fields of the options, or the faulty upload, `image` or `mask`."
    )
