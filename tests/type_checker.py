"""beartype with the numeric tower of PEP 484: an int passes where a hint says float."""

from beartype import BeartypeConf, beartype


checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
