"""What can go wrong in `core`, one class per thing that a caller can act on.

    CoreError
    ├── ScanError                 the scan cannot become a map
    │   ├── ScanFormatError       not a format that is known, or the name and the content disagree
    │   ├── ScanDamagedError      the file ends early or contradicts its own header
    │   └── ScanContentError      readable, but no colour, no finite points, or no extent
    │       └── ScanTooLargeError more points than allowed
    ├── PanoramaError             the image cannot be localized
    │   ├── PanoramaFormatError   not an image that is known
    │   │   └── MaskFormatError   the same of its mask
    │   ├── PanoramaDamagedError  the image ends early or does not decode
    │   │   └── MaskDamagedError  the same of its mask
    │   ├── PanoramaTooLargeError more pixels than allowed (checked before decoding)
    │   │   └── MaskTooLargeError the same of its mask
    │   ├── PanoramaShapeError    not 2:1, without crop fields, and of no known camera
    │   │   └── MaskShapeError    the mask has another shape than the image, or leaves nothing of it
    │   └── PanoramaUnusableError too small, next to nothing visible, or crop fields that contradict each other
    ├── OptionsError              a value out of its range
    ├── ExportRefusedError        placed photos cannot be written in the format that was asked for
    ├── IndexFormatError          bytes that are not a map index of this version
    └── DeadlineExceededError     the deadline passed before a pose was found

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


class ScanTooLargeError(ScanContentError):
    """The file has more points than allowed."""


class PanoramaError(CoreError):
    """The image cannot be localized."""


class PanoramaFormatError(PanoramaError):
    """The bytes are of no known image format."""


class MaskFormatError(PanoramaFormatError):
    """The mask's bytes are of no known image format."""


class PanoramaDamagedError(PanoramaError):
    """The image does not decode to its end."""


class MaskDamagedError(PanoramaDamagedError):
    """The mask does not decode to its end."""


class PanoramaTooLargeError(PanoramaError):
    """The image has more pixels than allowed."""


class MaskTooLargeError(PanoramaTooLargeError):
    """The mask has more pixels than allowed."""


class PanoramaShapeError(PanoramaError):
    """The image is not an equirectangular panorama, and nothing says which camera took it."""


class MaskShapeError(PanoramaShapeError):
    """The mask is not of the image's shape, or leaves nothing of the image."""


class PanoramaUnusableError(PanoramaError):
    """The image is too small, shows next to nothing, or contradicts itself."""


class OptionsError(CoreError):
    """An option is out of its range."""


class ExportRefusedError(CoreError):
    """Placed photos cannot be written in the format that was asked for."""


class IndexFormatError(CoreError):
    """The bytes are not a map index of this version."""


class DeadlineExceededError(CoreError):
    """The deadline passed before the work was done."""


CUT_SHORT = "The export or the upload was probably truncated: export the scan again and upload it again."
"""How the message about a scan ends that ends before its time."""
