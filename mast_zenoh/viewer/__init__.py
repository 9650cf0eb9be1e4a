"""The page that plays runs, and files of runs for other programs.

palette      all colours
page/        the page that plays runs in a browser
formats      the formats of exports, by name
export/      a file per format
"""
