"""Films and stills of finished runs, for talks and papers (docs/animations.md).

writing    `animate` and `snapshot`: from the folder of a run to a file
look       what a film shows and how it looks: options, checked
takes      what one panel shows: an estimate of an agent in a run, frame by frame
attacks    when attacks are on, and what they do in a frame
captions   what happens in a run, in words
framing    which part of the scene panels show
schedule   which frame of the run each image of a film shows
layout     where the parts of an image are
sheet      the whole image, of these parts: birdseye_panel, agent_marks, camera_panel, strip, legend, theme
pixels     draws only what changes from one image to the next
gif, video encode images
"""
