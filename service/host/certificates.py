"""A certificate for a service in a local network, and the local authority that signs it."""

import datetime
import ipaddress
import os
import socket
from collections.abc import Sequence
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from panoloc.service.host_names import host_names, is_address

# Phones refuse certificates of servers that are valid for longer than 398 days.
_SERVER_DAYS, _AUTHORITY_DAYS = 397, 3650

_SIGNS_CERTIFICATES = x509.KeyUsage(
    digital_signature=False, content_commitment=False, key_encipherment=False, data_encipherment=False, key_agreement=False,
    key_cert_sign=True, crl_sign=True, encipher_only=False, decipher_only=False,
)  # fmt: skip

_Signed = tuple[x509.Certificate, ec.EllipticCurvePrivateKey]


def make_certificate(folder: Path, names: Sequence[str]) -> list[str]:
    """Write `server.crt` and `server.key` into a folder, signed by `ca.crt` and `ca.key` there, which are made where they are missing.

    names: and addresses by which the service is called; none: those of the certificate that is there, else those of this machine. Returns
    them all. Raises ValueError for what is no name, and OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    certificate = folder / "server.crt"
    given = names or (_names_and_addresses(certificate) if certificate.exists() else _own_names())
    wanted = {str(_name(name).value): _name(name) for name in ("localhost", "127.0.0.1", *given)}
    authority = _authority(folder / "ca.crt", folder / "ca.key")
    _write(_made("panoloc", list(wanted.values()), authority), certificate, folder / "server.key")
    return list(wanted)


def names_in(certificate: Path) -> list[str]:
    """Return the host names, addresses aside, that a certificate (PEM) is for."""
    return [name for name in _names_and_addresses(certificate) if not is_address(name)]


def _names_and_addresses(certificate: Path) -> list[str]:
    try:
        found = x509.load_pem_x509_certificate(certificate.read_bytes()).extensions
        return [str(name.value) for name in found.get_extension_for_class(x509.SubjectAlternativeName).value]
    except (ValueError, x509.ExtensionNotFound):
        return []


def _own_names() -> list[str]:
    """Return the names of this machine, and the address by which others reach it."""
    name = socket.gethostname()
    found = [name, f"{name}.local"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing; the system chooses the address that it would send from
            found.append(str(probe.getsockname()[0]))
        except OSError:
            pass
    return found


def _authority(certificate: Path, key: Path) -> _Signed:
    """Return the authority of the folder, made where there is none. Raises OSError for files that are none."""
    if not certificate.exists() and not key.exists():
        _write(_made("panoloc local authority", (), None), certificate, key)
    try:
        secret = serialization.load_pem_private_key(key.read_bytes(), None)
        known = x509.load_pem_x509_certificate(certificate.read_bytes())
        if not isinstance(secret, ec.EllipticCurvePrivateKey) or secret.public_key() != known.public_key():
            raise ValueError("they do not belong together")
    except (OSError, ValueError, TypeError) as error:
        raise OSError(
            f"expected an authority in {certificate} and {key}, got none ({error}); remove both to make a new one"
        ) from error
    return known, secret


def _made(title: str, names: Sequence[x509.GeneralName], authority: _Signed | None) -> _Signed:
    """Return a certificate with its key. names: of a server. authority: that signs it; None: it is one itself."""
    secret = ec.generate_private_key(ec.SECP256R1())
    own = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"{title} ({socket.gethostname()})"[:64])])
    issuer, signer = (own, secret) if authority is None else (authority[0].subject, authority[1])
    began = datetime.datetime.now(datetime.UTC) - datetime.timedelta(hours=1)
    days = _AUTHORITY_DAYS if authority is None else _SERVER_DAYS
    builder = (
        x509.CertificateBuilder()
        .subject_name(own)
        .issuer_name(issuer)
        .public_key(secret.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(began)
        .not_valid_after(began + datetime.timedelta(days=days))
        .add_extension(x509.BasicConstraints(authority is None, 0 if authority is None else None), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(secret.public_key()), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), critical=False)
    )
    if authority is None:
        builder = builder.add_extension(_SIGNS_CERTIFICATES, critical=True)
    else:
        usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
        builder = builder.add_extension(usage, critical=False)
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return builder.sign(signer, hashes.SHA256()), secret


def _name(text: str) -> x509.GeneralName:
    """Return a name or an address as certificates have it. Raises ValueError."""
    if is_address(text):
        return x509.IPAddress(ipaddress.ip_address(text))
    try:
        name = text.encode("idna").decode("ascii")
        (known,) = host_names(name)
    except ValueError as error:
        raise ValueError(f"expected a name such as scanner.local, or an address, got {text[:80]!r}") from error
    if name == "*":
        raise ValueError("expected a name such as scanner.local, got '*', which phones do not accept")
    return x509.DNSName(known)


def _write(made: _Signed, certificate: Path, key: Path) -> None:
    """Write both as PEM; the key for its owner alone."""
    plain = serialization.NoEncryption()
    secret = made[1].private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
    key.unlink(missing_ok=True)
    with os.fdopen(os.open(key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(secret)
    certificate.write_bytes(made[0].public_bytes(serialization.Encoding.PEM))
