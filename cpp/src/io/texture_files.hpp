#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "io/formats.hpp"
#include "manip3d/files/atomic_file.hpp"

namespace manip3d {

/// Writes textures and material libraries into the folder of a mesh file, without folders in their
/// names. If a different file with the name exists, the name gets a hash of the content, so that no
/// file changes that an older mesh refers to. They appear in `commit()`, after the mesh file was
/// completely written under a temporary name: an error before that, such as a full disk, leaves
/// none of them behind, nor does an error until the mesh file has its name. Processes that write
/// into one folder at the same time never replace each other's files.
class CompanionFiles {
 public:
  explicit CompanionFiles(const WriteJob& job);

  /// The name in the mesh file for a material's texture with this role; "": it has none. With
  /// `only_ascii`, other characters become '_'.
  std::string texture_name(const Material& material, const std::string& role,
                           bool only_ascii = false);

  /// Bytes of a texture's image file; "" after a warning if there is no such file.
  std::string image(const Texture& texture);

  /// Stages `content` under `name`, or a name with a hash; returns the name.
  std::string place(const std::string& name, const std::string& content);

  /// Renames the files, after `output`, which refers to them, was completely written.
  /// @throws NameTaken  another process wrote a different file with one of the names meanwhile.
  void commit(Output& output);

 private:
  [[nodiscard]] std::optional<std::filesystem::path> find(const Texture& texture) const;

  const WriteJob& job_;
  std::filesystem::path folder_;
  std::map<std::string, std::string> name_of_path_;
  std::map<std::string, std::unique_ptr<AtomicFile>> staged_;  ///< By name.
};

/// The name in a form that fits a line of text: without control characters, blanks at the ends, or
/// a backslash at the end (which would continue the line).
std::string line_name(const std::string& name);

/// A name with '_' in place of each character that is not ASCII (in UTF-8).
std::string ascii_name(const std::string& name);

/// A distinct name for each material.
std::vector<std::string> unique_names(const std::vector<Material>& materials);

}  // namespace manip3d
