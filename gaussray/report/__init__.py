"""report.html: one HTML file that shows the results of a run."""

from gaussray.report.write import write_page as write_page
