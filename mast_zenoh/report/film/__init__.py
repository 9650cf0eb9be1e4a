"""Films and stills of finished runs, for talks and papers (docs/animations.md).

writing   `animate` and `snapshot`: from the folder of a run to a file; which frame each image shows
look      what a film shows and how it looks: options, checked; colours
takes     what one panel shows, frame by frame: boxes, attacks, captions, which part of the scene
panels    bird's-eye view, agents, camera view, and errors over time
sheet     the whole image: where its parts are, and its legend
encoding  images as pixels, and files of them
"""
