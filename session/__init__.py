"""The file formats, version 1: data classes in `records`, and a module for each reader and writer.

`records`, `keys`, `checks`, `flags` and `text_file` stand open; all else is entered by the names below.
"""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.session.atomic import atomic_write as atomic_write
    from bssrdf.session.atomic import inside as inside
    from bssrdf.session.atomic import make_folder as make_folder
    from bssrdf.session.atomic import replace_folder as replace_folder
    from bssrdf.session.atomic import sha256_of as sha256_of
    from bssrdf.session.atomic import sync as sync
    from bssrdf.session.constancy import CONSTANT_KINDS as CONSTANT_KINDS
    from bssrdf.session.constancy import card_of_file as card_of_file
    from bssrdf.session.constancy import check_constant as check_constant
    from bssrdf.session.constancy import check_no_copy as check_no_copy
    from bssrdf.session.constancy import differences as differences
    from bssrdf.session.constancy import with_cards as with_cards
    from bssrdf.session.file_kind import kind_of as kind_of
    from bssrdf.session.fit_json import failure_line as failure_line
    from bssrdf.session.fit_json import fit_line as fit_line
    from bssrdf.session.fit_json import fit_to_dict as fit_to_dict
    from bssrdf.session.fit_json import fits_in as fits_in
    from bssrdf.session.fit_json import read_fit as read_fit
    from bssrdf.session.fit_json import write_fit as write_fit
    from bssrdf.session.frame_files import ENCODED_SUFFIXES as ENCODED_SUFFIXES
    from bssrdf.session.frame_files import IMAGE_SUFFIXES as IMAGE_SUFFIXES
    from bssrdf.session.frame_files import is_frame_name as is_frame_name
    from bssrdf.session.frame_files import read_frame_file as read_frame_file
    from bssrdf.session.frame_files import read_linear_image as read_linear_image
    from bssrdf.session.frames_csv import SAME_EXPOSURE as SAME_EXPOSURE
    from bssrdf.session.frames_csv import append_frame as append_frame
    from bssrdf.session.frames_csv import dark_for as dark_for
    from bssrdf.session.frames_csv import read_frames as read_frames
    from bssrdf.session.frames_csv import recover_frames as recover_frames
    from bssrdf.session.frames_csv import write_frames as write_frames
    from bssrdf.session.hdr_image import OUR_PARTS as OUR_PARTS
    from bssrdf.session.hdr_image import HdrExr as HdrExr
    from bssrdf.session.hdr_image import is_ours as is_ours
    from bssrdf.session.hdr_image import read_hdr_exr as read_hdr_exr
    from bssrdf.session.hdr_image import write_hdr_exr as write_hdr_exr
    from bssrdf.session.ingest import ingest_folder as ingest_folder
    from bssrdf.session.oiio_file import read_image as read_image
    from bssrdf.session.oiio_file import write_exr as write_exr
    from bssrdf.session.oiio_file import write_png as write_png
    from bssrdf.session.plain import from_plain as from_plain
    from bssrdf.session.plain import to_plain as to_plain
    from bssrdf.session.progress import Progress as Progress
    from bssrdf.session.progress import counted as counted
    from bssrdf.session.raw_file import RAW_SUFFIXES as RAW_SUFFIXES
    from bssrdf.session.raw_frame import RawFrame as RawFrame
    from bssrdf.session.raw_frame import by_place as by_place
    from bssrdf.session.raw_frame import filled as filled
    from bssrdf.session.session_toml import TABLES as TABLES
    from bssrdf.session.session_toml import UNNAMED as UNNAMED
    from bssrdf.session.session_toml import checked_table as checked_table
    from bssrdf.session.session_toml import read_calibration as read_calibration
    from bssrdf.session.session_toml import read_session as read_session
    from bssrdf.session.session_toml import records_of as records_of
    from bssrdf.session.session_toml import write_calibration as write_calibration
    from bssrdf.session.session_toml import write_session as write_session
    from bssrdf.session.session_toml import write_template as write_template
    from bssrdf.session.slice_arrays import slice_from_arrays as slice_from_arrays
    from bssrdf.session.slice_arrays import slice_from_dataframe as slice_from_dataframe
    from bssrdf.session.slice_checks import COLUMNS as COLUMNS
    from bssrdf.session.slice_checks import NEEDED as NEEDED
    from bssrdf.session.slice_checks import Places as Places
    from bssrdf.session.slice_checks import check_curve as check_curve
    from bssrdf.session.slice_checks import check_size as check_size
    from bssrdf.session.slice_checks import check_values as check_values
    from bssrdf.session.slice_csv import HEADER as HEADER
    from bssrdf.session.slice_csv import about as about
    from bssrdf.session.slice_csv import overridden as overridden
    from bssrdf.session.slice_csv import read_slice as read_slice
    from bssrdf.session.slice_csv import slice_of as slice_of
    from bssrdf.session.slice_csv import write_slice as write_slice
    from bssrdf.session.slice_units import MM as MM
    from bssrdf.session.slice_units import doubt as doubt
    from bssrdf.session.verify import verify_session as verify_session
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
