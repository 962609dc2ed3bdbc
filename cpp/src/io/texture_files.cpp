#include "io/texture_files.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <set>
#include <system_error>
#include <thread>
#include <utility>

#include "io/warnings.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace fs = std::filesystem;
namespace {

std::string read_whole(const fs::path& path) {
  const auto source = file_source(path);
  std::string content;
  constexpr std::size_t kBlock = std::size_t{1} << 16;
  while (true) {
    const std::size_t size = content.size();
    content.resize(size + kBlock);
    const std::size_t got = source->read(content.data() + size, kBlock);
    content.resize(size + got);
    if (got == 0) return content;
  }
}

bool holds(const fs::path& path, const std::string& content) {
  std::error_code missing;
  return fs::is_regular_file(path, missing) && fs::file_size(path, missing) == content.size() &&
         !missing && read_whole(path) == content;
}

// Whether a file keeps its name. Its writer may remove it until the mesh that refers to it has its
// name as well, and holds its lock for this short time (AtomicFile::withdraw).
bool is_settled(const fs::path& path) {
  constexpr int kMostWaits = 1000;  // 10 s; somebody else holds the lock then
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC));
  if (!file.is_open()) return false;
  for (int waits = 0; ::flock(file.get(), LOCK_SH | LOCK_NB) != 0; ++waits) {
    if (errno != EWOULDBLOCK) break;  // a file system without locks
    if (waits == kMostWaits) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  struct ::stat mine{}, named{};
  return ::fstat(file.get(), &mine) == 0 && ::stat(path.c_str(), &named) == 0 &&
         mine.st_ino == named.st_ino && mine.st_dev == named.st_dev;
}

// FNV-1a, 64 bits, to distinguish files; files with equal hashes are compared byte by byte.
std::string hash_of(const std::string& content) {
  std::uint64_t hash = 0xCBF29CE484222325U;
  for (const char c : content) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001B3U;
  std::array<char, 16> digits{};
  const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), hash, 16).ptr;
  return {digits.data(), end};
}

const char* image_suffix(const std::vector<std::byte>& data) {
  return !data.empty() && data[0] == std::byte{0xFF} ? ".jpg" : ".png";
}

}  // namespace

CompanionFiles::CompanionFiles(const WriteJob& job)
    : job_(job), folder_(job.path.parent_path().empty() ? "." : job.path.parent_path()) {}

std::string CompanionFiles::place(const std::string& name, const std::string& content) {
  const fs::path plain(name);
  std::string candidate = name;
  for (int attempt = job_.options.hash_names ? 1 : 0;; ++attempt) {
    if (attempt > 0) {
      candidate = plain.stem().string();
      candidate.append("-").append(hash_of(content));
      if (attempt > 1) candidate.append("-").append(std::to_string(attempt - 1));
      candidate.append(plain.extension().string());
    }
    const fs::path path = folder_ / candidate;
    std::error_code missing;
    if (const auto staged = staged_.find(candidate); staged != staged_.end()) {
      if (holds(staged->second->temporary(), content)) return candidate;
    } else if (fs::exists(path, missing)) {
      if (holds(path, content) && is_settled(path)) return candidate;
    } else if (!job_.taken.contains(candidate)) {
      auto file = std::make_unique<AtomicFile>(path);
      file->write(content.data(), content.size());
      file->sync();
      staged_.emplace(candidate, std::move(file));
      return candidate;
    }
  }
}

void CompanionFiles::commit(Output& output) {
  output.finish();
  // All processes go through the names in the same order, hence two never wait for each other.
  for (auto& [name, file] : staged_) {
    const fs::path path = folder_ / name;
    AtomicFile& kept = output.keep(std::move(file));
    if (kept.commit_new()) continue;
    if (!holds(path, read_whole(kept.temporary())) || !is_settled(path)) {
      job_.taken.insert(name);
      throw NameTaken(path);
    }
  }
  staged_.clear();
}

std::string CompanionFiles::texture_name(const Material& material, const std::string& role,
                                         bool only_ascii) {
  const auto allowed = [&](std::string name) { return only_ascii ? ascii_name(name) : name; };
  const auto found = material.textures.find(role);
  if (found == material.textures.end() || found->second.empty()) return "";
  const Texture& texture = found->second;
  const std::string base = allowed(line_name(fs::path(texture.path).filename().string()));
  if (!texture.data.empty()) {
    const std::string name =
        base.empty() ? line_name(material.name + "_" + role) + image_suffix(texture.data) : base;
    std::string safe = allowed(name);
    std::replace(safe.begin(), safe.end(), '/', '_');
    return place(safe, {reinterpret_cast<const char*>(texture.data.data()), texture.data.size()});
  }
  if (base.empty()) return "";
  const auto [item, is_new] = name_of_path_.try_emplace(texture.path, base);
  if (!is_new) return item->second;
  const auto path = find(texture);
  if (!path) {
    warn(job_.warnings, "texture '" + texture.path + "' not found, only its name is written");
    return base;
  }
  return item->second = place(base, read_whole(*path));
}

std::string CompanionFiles::image(const Texture& texture) {
  if (!texture.data.empty()) {
    return {reinterpret_cast<const char*>(texture.data.data()), texture.data.size()};
  }
  const auto path = find(texture);
  if (path) return read_whole(*path);
  warn(job_.warnings, "texture '" + texture.path + "' not found and left out");
  return "";
}

std::optional<fs::path> CompanionFiles::find(const Texture& texture) const {
  const fs::path given(texture.path);
  if (!given.is_absolute() && job_.options.texture_folder.empty()) return std::nullopt;
  const fs::path path =
      given.is_absolute() ? given : resolve_inside(job_.options.texture_folder, texture.path);
  std::error_code refused;
  if (!fs::is_regular_file(path, refused)) return std::nullopt;
  return path;
}

std::string line_name(const std::string& name) {
  std::string result = name;
  for (char& c : result) {
    if (static_cast<unsigned char>(c) < ' ') c = '_';
  }
  if (result.ends_with('\\')) result.back() = '_';
  const auto first = result.find_first_not_of(' ');
  if (first == std::string::npos) return "";
  return result.substr(first, result.find_last_not_of(' ') - first + 1);
}

std::string ascii_name(const std::string& name) {
  std::string result;
  for (const char c : name) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 0x80) {
      result.push_back(c);
    } else if (byte >= 0xC0) {  // other bytes continue a character
      result.push_back('_');
    }
  }
  return result;
}

std::vector<std::string> unique_names(const std::vector<Material>& materials) {
  std::vector<std::string> names;
  std::set<std::string> taken;
  for (const Material& m : materials) {
    const std::string plain = m.name.empty() ? "material" : line_name(m.name);
    std::string name = plain;
    for (int i = 2; !taken.insert(name).second; ++i) name = plain + "_" + std::to_string(i);
    names.push_back(name);
  }
  return names;
}

}  // namespace manip3d
