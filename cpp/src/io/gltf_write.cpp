#include <algorithm>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>

#include "io/formats.hpp"
#include "io/gltf_scene.hpp"
#include "io/texture_files.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Json = nlohmann::ordered_json;

/// Converts JSON to text. Names that are not UTF-8 get replacement characters.
/// @param indent  -1: all on one line.
std::string to_text(const Json& json, int indent) {
  return json.dump(indent, ' ', false, Json::error_handler_t::replace);
}

/// Encodes a path as URI (RFC 3986): all characters become %XX, except unreserved ones and "/".
std::string encode_uri(std::string_view name) {
  constexpr std::string_view kDigits = "0123456789ABCDEF";
  constexpr std::string_view kUnreserved =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-._~";
  std::string uri;
  for (const char c : name) {
    if (kUnreserved.find(c) != std::string_view::npos) {
      uri += c;
    } else {
      const auto byte = static_cast<unsigned char>(c);
      uri += {'%', kDigits[byte / 16U], kDigits[byte % 16U]};
    }
  }
  return uri;
}

/// Writes a large buffer in pieces, because Output buffers its input.
void write_in_pieces(Output& output, std::string_view bytes) {
  constexpr std::size_t kPiece = std::size_t{1} << 20;
  for (; !bytes.empty(); bytes.remove_prefix(std::min(kPiece, bytes.size()))) {
    output.text(bytes.substr(0, kPiece));
  }
}

GltfScene build(const WriteJob& job, CompanionFiles& files) {
  return build_gltf(
      job.mesh, job.materials, [&](const Texture& texture) { return files.image(texture); },
      job.warnings, job.options);
}

std::string image_name(const GltfImage& image, const std::string& stem, std::size_t index) {
  const std::string name = line_name(std::filesystem::path(image.path).filename().string());
  if (!name.empty()) return name;
  return stem + "_" + std::to_string(index) + (image.mime_type == "image/png" ? ".png" : ".jpg");
}

}  // namespace

std::string finish_glb(GltfScene& scene) {
  for (std::size_t i = 0; i < scene.images.size(); ++i) {
    const std::size_t view = scene.add_buffer_view(scene.images[i].data);
    scene.json["images"][i] = {{"bufferView", view}, {"mimeType", scene.images[i].mime_type}};
  }
  const auto pad = [](std::string& chunk, char fill) {
    chunk.resize((chunk.size() + 3) / 4 * 4, fill);
  };
  pad(scene.buffer, '\0');
  scene.json["buffers"] = Json::array({{{"byteLength", scene.buffer.size()}}});
  std::string json = to_text(scene.json, -1);
  pad(json, ' ');
  const std::size_t total = 12 + 8 + json.size() + 8 + scene.buffer.size();
  if (total > std::numeric_limits<std::uint32_t>::max()) {
    throw InputError("mesh: a GLB file holds at most 4 GiB, this one takes " +
                     std::to_string(total) + " bytes; .gltf has no such limit");
  }
  std::string head = "glTF";
  const auto number = [&head](std::size_t value) {
    for (int shift = 0; shift < 32; shift += 8) head += static_cast<char>((value >> shift) & 0xFF);
  };
  number(2);
  number(total);
  number(json.size());
  head += "JSON" + json;
  number(scene.buffer.size());
  head.append("BIN\0", 4);
  return head;
}

void write_glb(Output& output, const WriteJob& job) {
  CompanionFiles files(job);
  GltfScene scene = build(job, files);
  write_glb(output, scene);
}

void write_glb(Output& output, GltfScene& scene) {
  output.text(finish_glb(scene));
  write_in_pieces(output, scene.buffer);
}

// Images and buffer are written first, under names that no other content has, so that an old .gltf
// stays valid until the new one replaces it.
void write_gltf(Output& output, const WriteJob& job) {
  CompanionFiles files(job);
  GltfScene scene = build(job, files);
  write_gltf(output, scene, job.path, files);
}

void write_gltf(Output& output, GltfScene& scene, const std::filesystem::path& path,
                CompanionFiles& files) {
  const std::string stem = without_compression_suffix(path).stem().string();
  for (std::size_t i = 0; i < scene.images.size(); ++i) {
    const GltfImage& image = scene.images[i];
    scene.json["images"][i] = {
        {"uri", encode_uri(files.place(image_name(image, stem, i), image.data))}};
  }
  scene.json["buffers"] =
      Json::array({{{"uri", encode_uri(files.place(stem + ".bin", scene.buffer))},
                    {"byteLength", scene.buffer.size()}}});
  output.text(to_text(scene.json, 1));
  output.text("\n");
  files.commit(output);
}

}  // namespace manip3d
