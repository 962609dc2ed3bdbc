#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/stat.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>
#include <thread>
#include <vector>

#include "manip3d/files/atomic_file.hpp"
#include "manip3d/files/temporary.hpp"

// Also run under the thread sanitizer.
namespace manip3d {
namespace {

namespace fs = std::filesystem;

class TemporaryTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "manip3d-test-XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
  }
  void TearDown() override { fs::remove_all(folder_); }

  [[nodiscard]] std::vector<std::string> names() const {
    std::vector<std::string> found;
    for (const auto& entry : fs::directory_iterator(folder_)) {
      found.push_back(entry.path().filename().string());
    }
    std::ranges::sort(found);
    return found;
  }
  /// Makes the file of a killed writer: nobody holds its lock.
  void leave(int number) const {
    std::ofstream(folder_ / (".manip3d-" + std::to_string(number))) << "half";
  }

  fs::path folder_;
};

using Names = std::vector<std::string>;

TEST_F(TemporaryTest, NamesOfLivingWritersAreLeftAlone) {
  const Temporary first = make_temporary(folder_, TemporaryKind::kFile, 0666);
  const Temporary second = make_temporary(folder_, TemporaryKind::kFolder, 0777);
  EXPECT_EQ(first.path.filename(), ".manip3d-0");
  EXPECT_EQ(second.path.filename(), ".manip3d-1");
  EXPECT_EQ(names(), (Names{".manip3d-0", ".manip3d-1"}));
}

TEST_F(TemporaryTest, WhatDeadWritersLeftIsRemoved) {
  const Temporary alive = make_temporary(folder_, TemporaryKind::kFile, 0666);
  for (const int number : {1, 2, 9, 24}) leave(number);
  fs::create_directories(folder_ / ".manip3d-3" / "deep");
  std::ofstream(folder_ / ".manip3d-3" / "deep" / "file") << "half";
  const Temporary mine = make_temporary(folder_, TemporaryKind::kFile, 0666);
  EXPECT_EQ(mine.path.filename(), ".manip3d-1");
  EXPECT_EQ(names(), (Names{".manip3d-0", ".manip3d-1"}));
}

TEST_F(TemporaryTest, OnlyFilesAndFoldersAreRemoved) {
  ASSERT_EQ(::mkfifo((folder_ / ".manip3d-0").c_str(), 0666), 0);
  std::ofstream(folder_ / "precious") << "data";
  fs::create_symlink(folder_ / "precious", folder_ / ".manip3d-1");
  fs::create_symlink(folder_ / "nowhere", folder_ / ".manip3d-2");
  const Temporary mine = make_temporary(folder_, TemporaryKind::kFile, 0666);
  EXPECT_EQ(mine.path.filename(), ".manip3d-3");
  EXPECT_EQ(names(), (Names{".manip3d-0", ".manip3d-1", ".manip3d-2", ".manip3d-3", "precious"}));
}

TEST_F(TemporaryTest, ReadOnlyLitterIsRemovedToo) {
  leave(0);
  fs::permissions(folder_ / ".manip3d-0", fs::perms::owner_read);
  {
    AtomicFile(folder_ / "a").commit();
  }
  EXPECT_EQ(names(), Names{"a"});
}

TEST_F(TemporaryTest, ManyWritersAtOnceLoseNothing) {
  constexpr int kThreads = 8, kWrites = 100;
  std::atomic<int> failures = 0;
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      const std::string text(1000, static_cast<char>('a' + t));
      const fs::path path = folder_ / std::to_string(t);
      for (int i = 0; i < kWrites; ++i) {
        AtomicFile file(path);
        file.write(text.data(), text.size());
        file.commit(false);
        std::ifstream in(path);
        const std::string found{std::istreambuf_iterator<char>(in), {}};
        failures += found == text ? 0 : 1;
        leave(100 + t);  // file of another killed writer, with a number far from the others
      }
    });
  }
  for (auto& thread : threads) thread.join();
  EXPECT_EQ(failures, 0);
}

TEST_F(TemporaryTest, TheModeIsTheOldFilesOrWhatTheMaskLeaves) {
  const fs::path path = folder_ / "a";
  const mode_t before = ::umask(027);
  {
    AtomicFile(path).commit();
  }
  ::umask(before);
  const auto mode = [&] { return static_cast<unsigned>(fs::status(path).permissions()); };
  EXPECT_EQ(mode(), 0640U);
  fs::permissions(path, fs::perms(0604));
  {
    AtomicFile(path).commit();
  }
  EXPECT_EQ(mode(), 0604U);
}

TEST_F(TemporaryTest, APrivateFilesSuccessorIsPrivateFromTheBeginning) {
  const fs::path path = folder_ / "a";
  std::ofstream(path) << "secret";
  fs::permissions(path, fs::perms(0600));
  const AtomicFile file(path);
  EXPECT_EQ(fs::status(folder_ / ".manip3d-0").permissions(), fs::perms(0600));
}

TEST_F(TemporaryTest, AFolderTakesTheNameOfAnother) {
  const Temporary temporary = make_temporary(folder_, TemporaryKind::kFolder, 0777);
  fs::create_directory(temporary.path / "new");
  std::ofstream(temporary.path / "new" / "n") << "n";
  replace_folder(temporary.path / "new", folder_ / "target");
  EXPECT_EQ(names(), (Names{".manip3d-0", "target"}));
  EXPECT_TRUE(fs::is_empty(temporary.path));
  fs::create_directory(temporary.path / "newer");
  replace_folder(temporary.path / "newer", folder_ / "target");
  EXPECT_TRUE(fs::is_empty(folder_ / "target"));
  EXPECT_FALSE(fs::is_empty(temporary.path));  // the old folder, for the caller to remove
}

TEST_F(TemporaryTest, AReplacedFolderOfADeadWriterIsRestoredWhereItIsMissing) {
  for (const std::string name : {"missing", "there"}) {
    fs::create_directories(folder_ / ".manip3d-0" / "old" / name);
    std::ofstream(folder_ / ".manip3d-0" / "old" / name / "file") << "old";
  }
  fs::create_directory(folder_ / ".manip3d-0" / "new");
  fs::create_directory(folder_ / "there");
  {
    AtomicFile(folder_ / "a").commit();
  }
  EXPECT_EQ(names(), (Names{"a", "missing", "there"}));
  EXPECT_TRUE(fs::exists(folder_ / "missing" / "file"));
  EXPECT_TRUE(fs::is_empty(folder_ / "there"));
}

TEST_F(TemporaryTest, ALinkIsNoReplacedFolder) {
  fs::create_directories(folder_ / "precious" / "target");
  fs::create_directory(folder_ / ".manip3d-0");
  fs::create_directory_symlink(folder_ / "precious", folder_ / ".manip3d-0" / "old");
  {
    AtomicFile(folder_ / "a").commit();
  }
  EXPECT_EQ(names(), (Names{"a", "precious"}));
  EXPECT_TRUE(fs::exists(folder_ / "precious" / "target"));
}

}  // namespace
}  // namespace manip3d
