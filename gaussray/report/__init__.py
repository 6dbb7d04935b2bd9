"""One page to look at, beside the files of a run: report.html."""

from gaussray.report.write import write_page as write_page
