#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "io/formats.hpp"
#include "manip3d/io/atomic_file.hpp"

namespace manip3d {

/// Puts textures and material libraries beside a mesh file, under base names; where a different
/// file of that name exists, the name gets a hash of the content, so that no file that an older
/// mesh refers to changes. They appear in `commit()`, after the mesh file was written as a whole
/// under a temporary name: an error before, such as a full disk, leaves none behind, nor does one
/// while the files get their names.
class CompanionFiles {
 public:
  explicit CompanionFiles(const WriteJob& job);

  /// Name that the mesh file shall use for the texture of a role; "" where there is none. With
  /// `only_ascii`, other characters of it become '_'.
  std::string texture_name(const Material& material, const std::string& role,
                           bool only_ascii = false);

  /// Bytes of a texture's image file; "" (with a warning) where it is not to be found.
  std::string image(const Texture& texture);

  /// Puts `content` beside the mesh file under `name` or a name with a hash, which it returns.
  std::string place(const std::string& name, const std::string& content);

  /// Lets the files appear, after `output`, which names them, was written as a whole.
  void commit(Output& output);

 private:
  [[nodiscard]] std::optional<std::filesystem::path> find(const Texture& texture) const;

  const WriteJob& job_;
  std::filesystem::path folder_;
  std::map<std::string, std::string> name_of_path_;
  std::map<std::string, std::unique_ptr<AtomicFile>> staged_;  ///< By name.
};

/// A name for a line of text: no control characters, no blanks at the ends, no backslash at the end
/// (it would continue the line).
std::string line_name(const std::string& name);

/// A name whose characters outside of ASCII, in UTF-8, are '_'.
std::string ascii_name(const std::string& name);

/// One name per material, each different.
std::vector<std::string> unique_names(const std::vector<Material>& materials);

}  // namespace manip3d
