"""The real controller: ABB's externally guided motion (EGM) over UDP."""
