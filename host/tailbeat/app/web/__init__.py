"""The live page: ``tailbeat session web``. Needs the package's extra ``ui``."""
