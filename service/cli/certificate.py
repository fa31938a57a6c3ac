"""`panoloc certificate`: a certificate for a service in a local network, and how phones trust it."""

from pathlib import Path
from typing import Annotated

import typer

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import JsonOption, Session

_HOW_TO_TRUST = """Start the service with it (one that runs has to be started again):
  PANOLOC_TLS_CERT={certificate} PANOLOC_TLS_KEY={key} panoloc serve --host 0.0.0.0
Let phones and computers trust {authority} (never give away {secret}):
  iPhone: send it the file, install the profile (Settings, Profile Downloaded), then switch it on under Settings, General,
          About, Certificate Trust Settings
  Android: Settings, Security, More security settings, Install a certificate, CA certificate
  programs: SSL_CERT_FILE={authority}"""


def certificate(
    ctx: typer.Context,
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names and addresses by which the service is called; default: those of before, else those of this machine."
        ),
    ] = None,
    folder: Annotated[Path, typer.Option(file_okay=False, help="Folder of the files.")] = Path("panoloc-tls"),
    json: JsonOption = False,
) -> int:
    """Make a certificate for the service, signed by a local authority, and say how a phone trusts it.

    The authority is made once: a certificate that is made later in the same folder is trusted already.
    """
    session = Session.of(ctx, json)
    from panoloc.service.host.certificates import make_certificate

    try:
        wanted = make_certificate(folder, names or ())
    except ValueError as error:
        session.messages.print(f"Error: {error}", markup=False)
        return ExitCode.USAGE
    paths = {name: str(folder / name) for name in ("ca.crt", "ca.key", "server.crt", "server.key")}
    session.show({"names": wanted, **paths}, paths["server.crt"])
    if not json:
        words = _HOW_TO_TRUST.format(
            certificate=paths["server.crt"], key=paths["server.key"], authority=paths["ca.crt"], secret=paths["ca.key"]
        )
        session.messages.print(f"for {', '.join(wanted)}\n{words}", markup=False, soft_wrap=True)
    return ExitCode.OK
