/** A worker that says when a face is due: a page in the background has no timers so fast. */

setInterval(() => postMessage(null), 33);
