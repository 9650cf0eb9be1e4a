"""Films and stills of finished runs, for talks and papers (docs/animations.md).

writing   `animate` and `snapshot`: from the folder of a run to a file; which frame each image shows
look      what a film shows and how it looks: options, checked
takes     what one panel shows, frame by frame: boxes, attacks and captions
panels    the bird's-eye view of figures/birdseye with driven cars, and errors over time
sheet     the whole image: where its parts are, and drawing what changes
encoding  Matplotlib's writers of films, for GIF, MP4 and WebM
"""
