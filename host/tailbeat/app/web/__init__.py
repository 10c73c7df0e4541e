"""The live page: ``tailbeat ui``. Needs the package's extra ``ui``."""
