"""Every reader of files, with small files that it reads."""

from experiments.hostile import captures, clouds, pictures, scenes, settings


READERS = captures.READERS | clouds.READERS | scenes.READERS | pictures.READERS | settings.READERS
