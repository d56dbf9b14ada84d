"""Templates of the page as they were compiled before."""

import contextlib
import hashlib
import marshal
import sys

import jinja2
from jinja2.bccache import Bucket

from jaxnarx.files import cache_folder, write_whole


class CompiledTemplates(jinja2.BytecodeCache):
    """A file for each template in the user's folder for caches.

    A file that cannot be read or written, or that is not whole or of another text or
    version, is as if it were not there.
    """

    def __init__(self) -> None:
        self.folder = cache_folder("pages")

    def load_bytecode(self, bucket: Bucket) -> None:
        """Take what is kept of a template, if it is of this text."""
        if self.folder is None:
            return
        with contextlib.suppress(OSError):
            data = (self.folder / bucket.key).read_bytes()
            mark = len(_digest(bucket, b""))
            if data[:mark] == _digest(bucket, data[mark:]):
                bucket.code = marshal.loads(data[mark:])

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep a template."""
        if self.folder is None or bucket.code is None:
            return
        code = marshal.dumps(bucket.code)
        with contextlib.suppress(OSError):
            write_whole(self.folder / bucket.key, _digest(bucket, code) + code)


def _digest(bucket: Bucket, code: bytes) -> bytes:
    """What tells that a file is whole, and of this text, Python and jinja2."""
    about = f"{sys.version} {jinja2.__version__} {bucket.checksum}"
    return hashlib.sha256(about.encode() + code).digest()
