"""The rows and cells of every table in a report, for terminal, Markdown, CSV, LaTeX and HTML."""
