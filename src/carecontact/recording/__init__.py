"""A trial as a file: schema, writer, one verified read, canonical hash, and export; without a simulator."""

from carecontact.recording.file import canonical_hash as canonical_hash
from carecontact.recording.file import open_recording as open_recording
from carecontact.recording.file import read_header as read_header
from carecontact.recording.file import read_recording as read_recording
from carecontact.recording.file import stored_sha256 as stored_sha256
from carecontact.recording.file import write_recording as write_recording
from carecontact.recording.schema import ARRAYS as ARRAYS
from carecontact.recording.schema import OPTIONAL_ARRAYS as OPTIONAL_ARRAYS
from carecontact.recording.schema import SCHEMA_VERSION as SCHEMA_VERSION
from carecontact.recording.schema import SEGMENTS as SEGMENTS
from carecontact.recording.schema import EndReason as EndReason
from carecontact.recording.schema import Failure as Failure
from carecontact.recording.schema import Header as Header
from carecontact.recording.schema import Recording as Recording
from carecontact.recording.schema import empty_arrays as empty_arrays
