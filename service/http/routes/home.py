"""Pages for people: what this is, the maps it has, and what each kind of problem means."""

from html import escape

from fastapi import APIRouter, Request
from starlette.responses import HTMLResponse, JSONResponse, Response

from service.http.error_handlers import plain_problem_response
from service.maps.record import MapRecord
from service.problems import HTTP_PROBLEMS, error_responses, known_problems
from service.services import services_of

router = APIRouter(tags=["operations"])

_MOST_MAPS = 60
_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>panoloc</title>
<style>
  body {{ font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 64rem; padding: 0 1rem; color: #1c2024 }}
  a {{ color: #0b62a8 }} h1 {{ margin: 0 }}
  ul {{ display: grid; gap: 1rem; grid-template-columns: repeat(auto-fill, minmax(14rem, 1fr)); list-style: none; padding: 0 }}
  li {{ border: 1px solid #d5dae0; border-radius: .5rem; overflow: hidden }}
  li img {{ aspect-ratio: 1; display: block; object-fit: contain; width: 100%; background: #f4f6f8 }}
  li p {{ margin: .5rem .75rem }} code {{ font-size: .85em }}
</style>
<h1>panoloc</h1>
<p>Finds where a 360° photo was taken inside a scanned place.
<a href="/docs">API</a> · <a href="/health">health</a> · <a href="/metrics">metrics</a></p>
{maps}
</html>
"""


@router.get("/", include_in_schema=False)
async def home(request: Request) -> Response:
    """Show the maps with their pictures; with API keys set, browsers cannot fetch those and only learn what this is."""
    services = services_of(request)
    if services.settings.keys.required:
        return HTMLResponse(_PAGE.format(maps="<p>Maps are shown to callers with an API key: GET /maps.</p>"))
    records = services.registry.all()
    cards = "".join(_card(record) for record in records[-_MOST_MAPS:][::-1])
    shown = (
        f"<p>{len(records)} maps</p><ul>{cards}</ul>" if records else "<p>No maps yet: POST /maps registers a scan.</p>"
    )
    return HTMLResponse(_PAGE.format(maps=shown))


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


def _card(record: MapRecord) -> str:
    name, where = escape(record.name), f"/maps/{escape(record.id)}"
    picture = f'<img src="{where}/preview.png" alt="{name} from above" loading="lazy">' if record.serving else ""
    return (
        f'<li><a href="{where}">{picture}</a><p><strong>{name}</strong><br>{escape(record.newest.status)}'
        f"<br><code>{escape(record.id)}</code></p></li>"
    )
