"""A certificate authority, and certificates of it, made for one test."""

import json
import subprocess
from pathlib import Path
from typing import Final

KEY: Final = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
EXTENSIONS: Final = (
    "subjectAltName=DNS:{name}\nextendedKeyUsage=serverAuth,clientAuth\nbasicConstraints=CA:FALSE\n"
)


class Authority:
    """Makes certificates, and Zenoh files of sessions that speak TLS alone and ask for a certificate."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._openssl("req", "-x509", *KEY, "-keyout", "ca.key", "-out", "ca.pem", "-days", "2", "-subj", "/CN=ca")

    def zenoh_file(self, name: str, **entries: object) -> str:
        """A Zenoh configuration file whose certificate carries this name, with further entries."""
        (self._directory / f"{name}.ext").write_text(EXTENSIONS.format(name=name))
        self._openssl("req", *KEY, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
        self._openssl(
            *("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial"),
            *("-out", f"{name}.pem", "-days", "2", "-extfile", f"{name}.ext"),
        )
        certificate, key = (str(self._directory / f"{name}.{kind}") for kind in ("pem", "key"))
        tls = {
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "root_ca_certificate": str(self._directory / "ca.pem"),
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
        }
        path = self._directory / f"{name}.json5"
        path.write_text(json.dumps({"transport": {"link": {"protocols": ["tls"], "tls": tls}}, **entries}))
        return str(path)

    def _openssl(self, *words: str) -> None:
        subprocess.run(["/usr/bin/env", "openssl", *words], cwd=self._directory, check=True, capture_output=True)
