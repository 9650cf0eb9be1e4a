"""Films and stills of finished runs, for talks and papers (docs/how-to-export.md#films-and-figures).

writing   `animate` and `snapshot`: from the folder of a run to a file; which frame each image shows; Matplotlib's
          writers of films, for GIF, MP4 and WebM
takes     what one panel shows, frame by frame: boxes, attacks and captions; what a film shows and how it looks:
          options, checked
sheet     the whole image: where its parts are, and drawing what changes; the bird's-eye view of figures/birdseye with
          driven cars, and errors over time
"""
