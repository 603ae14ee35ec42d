"""An RTSP server of GStreamer: rtsp://127.0.0.1:PORT/h264 and /jpeg, 160 x 120 px, 20 a second, of one brightness.

It prints its port, then a line for each line read, which names the pattern that is sent from then on (black, white).
Run by an interpreter that has gi and GstRtspServer; without them it ends with the reason.
"""

import sys
import threading

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

LIVE = "videotestsrc name=source is-live=true pattern=black ! video/x-raw,width=160,height=120,framerate=20/1"
ENCODED = {
    "h264": ("x264enc tune=zerolatency key-int-max=10", "rtph264pay name=pay0 config-interval=1"),
    "jpeg": ("jpegenc", "rtpjpegpay name=pay0"),
}


def main():
    Gst.init(None)
    sources = []
    server = GstRtspServer.RTSPServer(service="0", address="127.0.0.1")
    for name, (encoder, payload) in ENCODED.items():
        if Gst.ElementFactory.find(encoder.split()[0]) is None:
            sys.exit(f"GStreamer has no {encoder.split()[0]}")
        factory = GstRtspServer.RTSPMediaFactory(shared=True)
        factory.set_launch(f"( {LIVE} ! videoconvert ! video/x-raw,format=I420 ! {encoder} ! {payload} )")
        factory.connect(
            "media-configure", lambda _, media: sources.append(media.get_element().get_by_name_recurse_up("source"))
        )
        server.get_mount_points().add_factory(f"/{name}", factory)
    server.attach(None)
    print(server.get_bound_port(), flush=True)

    def answer():
        for line in sys.stdin:
            for source in sources:
                source.set_property("pattern", line.strip())
            print(line.strip(), flush=True)

    threading.Thread(target=answer, daemon=True).start()
    GLib.MainLoop().run()


if __name__ == "__main__":
    main()
