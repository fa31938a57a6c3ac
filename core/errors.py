"""What can go wrong in `core`, one class per thing that a caller can act on.

    CoreError
    ├── ScanError                 the scan cannot become a map
    │   ├── ScanFormatError       not a format that is known, or the name and the content disagree
    │   ├── ScanDamagedError      the file ends early or contradicts its own header
    │   └── ScanContentError      readable, but no colour, no finite points, or no extent
    ├── PanoramaError             the image cannot be localized
    │   ├── PanoramaFormatError   not an image that is known
    │   ├── PanoramaDamagedError  the image ends early or does not decode
    │   ├── PanoramaTooLargeError more pixels than allowed (checked before decoding)
    │   └── PanoramaShapeError    not 2:1 and without crop fields, or the mask does not fit
    ├── OptionsError              a value out of its range
    ├── IndexFormatError          bytes that are not a map index of this version
    ├── DeadlineExceededError     the deadline passed before a pose was found
    └── CancelledError            the caller withdrew the work

Every message says what was expected, what came, and what to do.
"""


class CoreError(Exception):
    """Base of everything that `core` raises on purpose."""


class ScanError(CoreError):
    """The scan cannot become a map."""


class ScanFormatError(ScanError):
    """The file is of no known scan format."""


class ScanDamagedError(ScanError):
    """The file ends early or contradicts its own header."""


class ScanContentError(ScanError):
    """The file is readable but holds nothing to localize in."""


class PanoramaError(CoreError):
    """The image cannot be localized."""


class PanoramaFormatError(PanoramaError):
    """The bytes are of no known image format."""


class PanoramaDamagedError(PanoramaError):
    """The image does not decode to its end."""


class PanoramaTooLargeError(PanoramaError):
    """The image has more pixels than allowed."""


class PanoramaShapeError(PanoramaError):
    """The image is not an equirectangular panorama, or its mask does not fit."""


class OptionsError(CoreError):
    """An option is out of its range."""


class IndexFormatError(CoreError):
    """The bytes are not a map index of this version."""


class DeadlineExceededError(CoreError):
    """The deadline passed before the work was done."""


class CancelledError(CoreError):
    """The caller withdrew the work."""
