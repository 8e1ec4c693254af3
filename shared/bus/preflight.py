"""Find out why no connection to an endpoint comes about, and say it in words.

Zenoh tries again in silence. This module opens one connection itself, up to the TLS handshake, and
says how far it came. It sends no message.
"""

from __future__ import annotations

import socket
import ssl

from shared.bus.endpoint import parse_endpoint
from shared.bus.security import Credentials
from shared.errors import LinkError

_SECONDS = 2.0
# A server refuses the client's certificate after the client's handshake is over (TLS 1.3).
_REFUSAL_SECONDS = 0.3
_DATAGRAM = ("quic", "udp")
_SAME_EDGE = (
    "does an edge listen there or at the router (it says what it refuses), with the same --name, "
    "task, robot, wbc and walk settings"
)


def preflight(endpoint: str, credentials: Credentials | None) -> str:
    """Return in words how far a connection to `endpoint` comes.

    Raise `LinkError` if waiting cannot help, because one end refuses the other's certificate.
    """
    where = parse_endpoint(endpoint, secured=credentials is not None)
    if where.port == 0:
        return f"{endpoint} accepts no connection; start the edge there"
    host, port = where.host, where.port
    try:
        family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError):
        return (
            f"{endpoint}: this machine does not know {host}; give an address, or correct the name"
        )
    if where.protocol in _DATAGRAM:
        return f"{endpoint}: is the edge started, and is its UDP port {port} open in its firewall?"
    try:
        with socket.socket(family, kind) as plain:
            plain.settimeout(_SECONDS)
            plain.connect(address)
            if where.protocol == "tls" and credentials is not None:
                answers = _shake_hands(plain, host, endpoint, credentials)
                if not answers:
                    return f"{endpoint} accepts connections, but no TLS; is it a plain endpoint?"
    except ConnectionRefusedError:
        return f"{endpoint} refuses connections; start the edge there, or correct the address"
    except TimeoutError:
        return (
            f"{endpoint} does not answer; is that machine on, and port {port} open in its firewall?"
        )
    except OSError as error:
        return f"{endpoint} cannot be reached: {error.strerror or error}"
    if credentials is None:
        return f"{endpoint} accepts connections; {_SAME_EDGE}, and without --secure?"
    return f"{endpoint} accepts this certificate; {_SAME_EDGE}?"


def _shake_hands(plain: socket.socket, host: str, endpoint: str, credentials: Credentials) -> bool:
    """Return whether the server speaks TLS.

    Raise `LinkError` if one end refuses the other's certificate.
    """
    try:
        secured = credentials.client_context().wrap_socket(plain, server_hostname=host)
    except TimeoutError:
        return False
    except ssl.SSLCertVerificationError as error:
        raise LinkError(
            f"{endpoint}: its certificate is not accepted here "
            f"({error.verify_message.rstrip('.')}); {_remedy(error.verify_code, host)}"
        ) from None
    except ssl.SSLError:
        return False
    with secured:
        secured.settimeout(_REFUSAL_SECONDS)
        try:
            secured.recv(1)
        except TimeoutError:
            return True
        except ssl.SSLError as error:
            reason = (error.reason or str(error)).lower().replace("_", " ")
            raise LinkError(
                f"{endpoint} refuses the certificate of {credentials.role} ({reason}); give both "
                "machines the same ca.crt and certificates signed by it, and set their clocks"
            ) from None
    return True


# OpenSSL: X509_V_ERR_…
_EXPIRED, _NOT_YET_VALID = 10, 9
_HOSTNAME_MISMATCH, _IP_ADDRESS_MISMATCH = 62, 64


def _remedy(code: int, host: str) -> str:
    if code in (_HOSTNAME_MISMATCH, _IP_ADDRESS_MISMATCH):
        return f"make it with `wbc keys DIR --host {host}`, or dial a name that it has"
    if code == _EXPIRED:
        return "make a new one with `wbc keys DIR --add`"
    if code == _NOT_YET_VALID:
        return "set the clocks of both machines"
    return "both machines need the ca.crt that signed the certificates of both"
