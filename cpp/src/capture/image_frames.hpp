#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "capture/recording_lock.hpp"
#include "manip3d/capture/rgbd_source.hpp"

namespace manip3d {

/// Largest text file of a folder, bytes.
inline constexpr std::uint64_t kMaxFolderText = std::uint64_t{64} << 20;

/// The file of an image that has not been read yet.
struct ImageFile {
  std::filesystem::path path;  ///< Empty: the frame has no such image.
  std::optional<std::uint32_t> crc32;
};

struct FrameFiles {
  std::int64_t number = 0, time_ns = 0;
  ImageFile depth, body_index, color;
  std::vector<Skeleton> skeletons;
};

/// Lists the next frame of a folder; returns false at the end.
using NextFrameFiles = std::function<bool(FrameFiles&)>;

/// Frames from lists of image files.
class ImageFrames final : public RgbdSource {
 public:
  struct Listing {
    NextFrameFiles next;
    std::function<void(std::int64_t)> seek;  ///< Goes to a frame, or to the end.
    std::int64_t num_frames = 0;
    Counters counters;                      ///< Counts of the listing itself.
    std::shared_ptr<RecordingLock> lock{};  ///< Lock of a recording; held until `stop` or the end.
    /// Do pixels of 65535 mean "no measurement", as in the images of many cameras and data sets
    /// (7-Scenes)? In manip3d's own recordings only 0 does.
    bool marks_missing = false;
    double assumed_rate = 0.0;  ///< Frames per second of files without times; 0: they have times.
  };

  /// @param stored  Cameras of the images as stored in the files.
  ImageFrames(Listing listing, std::shared_ptr<const RgbdCalibration> stored,
              double units_per_metre);

  [[nodiscard]] SourceCapabilities capabilities() const override { return {}; }
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override {
    return calibration_;
  }
  [[nodiscard]] Counters counters() const override;
  [[nodiscard]] Conversions conversions() const override;
  [[nodiscard]] std::optional<std::int64_t> num_frames() const override {
    return listing_.num_frames;
  }
  void start() override {}
  /// Frames that are not later than the previous one are skipped and counted. After a FormatError
  /// the next call continues after the damaged frame.
  ReadStatus read(RgbdFrame& frame, std::chrono::milliseconds timeout) override;
  /// The frame that is sought is not skipped, even if it is out of order.
  void seek(std::int64_t index) override;
  void stop() override {
    if (listing_.lock) listing_.lock->release();
  }

 private:
  void load(RgbdFrame& frame);

  Listing listing_;
  std::shared_ptr<const RgbdCalibration> stored_, calibration_;
  double units_per_metre_;
  FrameFiles files_;
  std::optional<std::pair<std::int64_t, std::int64_t>> last_;  // number and time
  std::int64_t frames_ = 0, out_of_order_ = 0, damaged_ = 0, unregistered_color_ = 0;
  std::int64_t marked_ = 0;  // pixels that stored 65535, which are not measured
  std::int64_t narrow_ = 0;  // frames whose depth was stored in 8 bits
};

/// Parses a line of frames.jsonl; the images are in subfolders of `folder`.
/// @throws FormatError  with the number of the line.
void parse_frame_line(std::string_view text, std::int64_t line, const std::filesystem::path& folder,
                      FrameFiles& files);

/// Parses the text of a calibration.json. Cameras stay as stored (see unmirrored()).
/// @throws FormatError
std::shared_ptr<const RgbdCalibration> parse_calibration(std::string_view text);

/// A file of a TUM sequence.
struct TimedFile {
  std::int64_t time_ns = 0;
  std::string name;
};
struct TumList {
  std::vector<TimedFile> files;  ///< Sorted by time.
  bool is_torn = false;          ///< Was the last line left out?
};
/// Parses depth.txt or rgb.txt.
///
/// A writer that was killed, or a copy that was interrupted, leaves a part of the last line. A last
/// line without a line break is therefore left out if it is no line of a list, or if its file does
/// not exist.
/// @throws FormatError  with the number of the line.
TumList parse_tum_list(std::string_view text,
                       const std::function<bool(const std::string&)>& exists);

/// Pairs files that differ by at most `most_ns`, each in one pair at most: as many pairs as
/// possible, and of these pairings the one with the least sum of differences. (The benchmark's
/// associate.py takes the nearest pairs first, which leaves images without a partner that could
/// have one.) Returns for each file the index of its partner in `others`, or -1. Both lists are
/// sorted. More than 8 of the others that are near a file do not all count.
std::vector<std::int64_t> associate(const std::vector<TimedFile>& files,
                                    const std::vector<TimedFile>& others, std::int64_t most_ns);

}  // namespace manip3d
