#include "capture/mkv_library.hpp"

#include <atomic>
#include <cerrno>

#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

FoundMkvCodec find_none() {
  return {nullptr, "no codec library is linked", "call set_mkv_loader() first"};
}

// Atomic instead of a mutex, because the loader may wait for another lock, such as Python's.
std::atomic<MkvLoader> loader = find_none;
std::atomic<const MkvCodec*> loaded = nullptr;

FoundMkvCodec checked(FoundMkvCodec found) {
  if (found.codec == nullptr) return found;
  if (found.codec->version != kMkvVersion || found.codec->size != sizeof(MkvCodec)) {
    return {nullptr,
            "the codec library has interface " + std::to_string(found.codec->version) +
                ", expected " + std::to_string(kMkvVersion),
            "install all of manip3d again"};
  }
  const std::string missing = found.codec->missing();
  if (missing.empty()) return found;
  return {nullptr, "FFmpeg was built without " + missing, "use an FFmpeg that has it"};
}

}  // namespace

void set_mkv_loader(MkvLoader load) {
  loader = load;
  loaded = nullptr;
}

FoundMkvCodec find_mkv_codec() {
  if (const MkvCodec* codec = loaded) return {codec, "", ""};
  FoundMkvCodec found = checked(loader.load()());
  loaded = found.codec;
  return found;
}

const MkvCodec& mkv_codec() {
  const FoundMkvCodec found = find_mkv_codec();
  if (found.codec != nullptr) return *found.codec;
  throw DeviceError("mkv: " + found.reason + " (" + found.cure + ")");
}

std::string mkv_error(int code) {
  if (code == -ENOMEM) return "no memory for it, or a size in it is beyond all memory";
  char text[128] = {};
  mkv_codec().describe(code, text, sizeof(text));
  return text;
}

}  // namespace manip3d
