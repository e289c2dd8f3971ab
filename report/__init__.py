"""What people read: the material table, a fit in words, figures, progress."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.report.doctor import doctor_text as doctor_text
    from bssrdf.report.doctor import examine as examine
    from bssrdf.report.forward import curve_csv as curve_csv
    from bssrdf.report.forward import draw_curve as draw_curve
    from bssrdf.report.notebook import draw_fit as draw_fit
    from bssrdf.report.notebook import fit_html as fit_html
    from bssrdf.report.notebook import write_page as write_page
    from bssrdf.report.page import write_report as write_report
    from bssrdf.report.progress import live as live
    from bssrdf.report.progress import stages as stages
    from bssrdf.report.progress import steps as steps
    from bssrdf.report.table import fits_table as fits_table
    from bssrdf.report.table import published_table as published_table
    from bssrdf.report.text import fit_text as fit_text
    from bssrdf.report.text import measured_text as measured_text
    from bssrdf.report.text import wrapped as wrapped
    from bssrdf.report.validation import Check as Check
    from bssrdf.report.validation import draw_validation as draw_validation
    from bssrdf.report.validation import validate as validate
    from bssrdf.report.validation import validation_text as validation_text
    from bssrdf.report.views import views_text as views_text
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
