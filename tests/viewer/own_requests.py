"""HTTP requests to a server on the loopback address."""

import http.client


def answer(port: int, path: str, host: str = "127.0.0.1") -> http.client.HTTPResponse:
    """Get a path under the name of a host."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.putrequest("GET", path, skip_host=True)
    connection.putheader("Host", f"{host}:{port}")
    connection.endheaders()
    return connection.getresponse()
