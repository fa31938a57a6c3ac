"""A page for people and programs: what each kind of problem means."""

from fastapi import APIRouter, Request
from starlette.responses import JSONResponse, Response

from service.http.error_handlers import plain_problem_response
from service.problems import HTTP_PROBLEMS, error_responses, known_problems

router = APIRouter(tags=["operations"])


@router.get(
    "/problems/{slug}", summary="What a kind of problem means", response_model=None, responses=error_responses(404)
)
async def problem(request: Request, slug: str) -> Response:
    """Explain the `type` of a problem document."""
    found = known_problems().get(slug)
    if found is None:
        detail = f"expected the end of a problem's type, got {slug[:80]!r}; one of {', '.join(known_problems())}"
        return plain_problem_response(HTTP_PROBLEMS[404], detail, request)
    return JSONResponse({"type": found.type, "title": found.title, "status": found.status, "advice": found.advice})
