"""Whether the XML in which an E57 file describes itself is safe to hand to libE57.

libE57 compares every child of a structure with all before it, follows nesting by recursion, and knows no limits: half a megabyte of
siblings took it 6 s, 1.7 MB 47 s. So the XML is walked once before, in linear time and without a tree, and refused where no scanner's
file would be.
"""

from xml.parsers import expat

from core.errors import ScanContentError, ScanDamagedError

# A station takes 3 to 5 kB, a picture 2 kB: thousands of each fit.
MAX_XML_BYTES = 32 << 20
_MAX_NODES = 500_000
_MAX_DEPTH = 64
# The standard names about thirty for the largest structure, extensions add a few.
_MAX_CHILDREN = 256
_MAX_ATTRIBUTES = 64


def check_description(xml: bytes) -> None:
    """Raise ScanDamagedError for what E57 does not allow, ScanContentError for what takes too long to read."""
    if b"\x00" in xml:
        raise ScanDamagedError("The XML description of the E57 file is not UTF-8. Export the scan again.")
    if b"<!" in xml.replace(b"<![CDATA[", b"").replace(b"<!--", b""):
        raise _entities()
    try:
        _Walk().parse(xml)
    except expat.ExpatError as error:
        raise ScanDamagedError(f"The XML description of the E57 file is damaged: {error}. Export it again.") from error


class _Walk:
    """Counts what libE57 would build."""

    def __init__(self) -> None:
        self._num_nodes = 0
        # Of each open element: whether it is a structure, and its children so far.
        self._open: list[tuple[bool, int]] = []

    def parse(self, xml: bytes) -> None:
        """Go through the XML; what the handlers raise ends it."""
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._begin
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._refuse_document_type
        parser.Parse(xml, True)

    def _begin(self, name: str, attributes: dict[str, str]) -> None:
        self._num_nodes += 1
        if self._num_nodes > _MAX_NODES:
            raise _too_much(f"more than {_MAX_NODES:,} nodes")
        if len(attributes) > _MAX_ATTRIBUTES:
            raise _too_much(f"an element with {len(attributes):,} attributes")
        if self._open:
            is_structure, num_children = self._open[-1]
            if is_structure and num_children == _MAX_CHILDREN:
                raise _too_much(f"a structure of more than {_MAX_CHILDREN} children")
            self._open[-1] = (is_structure, num_children + 1)
        self._open.append((attributes.get("type") != "Vector", 0))
        if len(self._open) > _MAX_DEPTH:
            raise _too_much(f"more than {_MAX_DEPTH} levels")

    def _end(self, name: str) -> None:
        self._open.pop()

    def _refuse_document_type(self, *declared: object) -> None:
        # In an encoding whose `<!` are other bytes.
        raise _entities()


def _entities() -> ScanDamagedError:
    """The parser would expand entities without limit and open the files that they name."""
    return ScanDamagedError("The E57 file declares XML entities or a document type; E57 allows neither.")


def _too_much(found: str) -> ScanContentError:
    return ScanContentError(
        f"The XML description of the E57 file has {found}, which no scanner writes. Export the scan again, or as LAZ or PLY."
    )
