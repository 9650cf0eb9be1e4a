"""Films and stills of finished runs, for talks and papers (docs/animations.md).

writing        `animate` and `snapshot`: from the folder of a run to a file
look           what a film shows and how: options, checked
takes          what one panel shows: an estimate of an agent in a run, frame by frame
captions       what happens in a run, in words, by frame
conduct_state  attacks over time: when one is on, and what it does in a frame
framing        which part of the scene panels show
schedule       which frame of the run each picture of a film shows
sheet          the whole picture: panels, title, numbers, time strips, caption, legend
birdseye_panel, camera_panel, strip, legend, theme    its parts
pixels         draws only what changes from one picture to the next
gif, video     encodes pictures
output         a file that is complete, or not there at all
"""
