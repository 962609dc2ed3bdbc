#pragma once

#include "manip3d/capture/mkv_codec.hpp"

namespace manip3d {

/// Codec and muxer of recordings with FFmpeg (libavformat, libavcodec, libavutil), 5.1 or later.
const MkvCodec& ffmpeg_mkv_codec();

}  // namespace manip3d
