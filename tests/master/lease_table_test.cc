#include "master/lease_table.h"

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <string>

namespace preheat {
namespace {

using std::chrono::seconds;

constexpr WorkerId kAnn{0};
constexpr WorkerId kBob{1};
constexpr WorkerId kCyd{2};
constexpr Hash128 kRight{1, 1};
constexpr Hash128 kWrong{2, 2};
constexpr Time kStart{};

// Two tiles.
LeaseTable small_table() {
  LeaseTable table{TileGrid{64, 32, 32}, seconds(10), /*seed=*/1};
  for (const WorkerId worker : {kAnn, kBob, kCyd}) { table.add_worker(worker); }
  return table;
}

TEST(LeaseTable, CommitsTheFirstResultOfEachTile) {
  LeaseTable table = small_table();
  const Lease first = table.grant(kAnn, kStart).value();
  const Lease second = table.grant(kBob, kStart).value();

  EXPECT_EQ(table.result(kAnn, first.id, kRight, kStart).outcome, ResultOutcome::kCommitted);
  EXPECT_FALSE(table.finished());
  EXPECT_EQ(table.result(kBob, second.id, kRight, kStart).outcome, ResultOutcome::kCommitted);

  EXPECT_NE(first.tile, second.tile);
  EXPECT_TRUE(table.finished());
  EXPECT_EQ(table.grant(kCyd, kStart), std::nullopt);
}

TEST(LeaseTable, ALeaseIdIsGoodOnceAndForItsWorkerOnly) {
  LeaseTable table = small_table();
  const Lease lease = table.grant(kAnn, kStart).value();

  EXPECT_EQ(table.result(kBob, lease.id, kRight, kStart).outcome, ResultOutcome::kUnknown);
  EXPECT_EQ(table.result(kAnn, lease.id, kRight, kStart).outcome, ResultOutcome::kCommitted);
  EXPECT_EQ(table.result(kAnn, lease.id, kRight, kStart).outcome, ResultOutcome::kUnknown);
  EXPECT_EQ(table.tiles_committed(), 1U);
}

TEST(LeaseTable, ExpiresWithoutProgressAndNotWithIt) {
  LeaseTable table = small_table();
  const Lease still = table.grant(kAnn, kStart).value();
  static_cast<void>(table.grant(kBob, kStart));
  table.progress(kBob, kStart + seconds(9));

  const auto expired = table.expire(kStart + seconds(10));
  ASSERT_EQ(expired.size(), 1U);
  EXPECT_EQ(expired[0].second, still);
  EXPECT_EQ(table.grant(kCyd, kStart + seconds(10))->tile, still.tile);
}

TEST(LeaseTable, ALateResultIsComparedAndDropped) {
  LeaseTable table = small_table();
  const Lease late = table.grant(kAnn, kStart).value();
  table.remove_worker(kAnn);
  const Lease again = table.grant(kBob, kStart).value();
  ASSERT_EQ(again.tile, late.tile);

  EXPECT_EQ(table.result(kBob, again.id, kRight, kStart).outcome, ResultOutcome::kCommitted);
  EXPECT_EQ(table.result(kAnn, late.id, kRight, kStart).outcome, ResultOutcome::kDuplicate);
  EXPECT_EQ(table.stats().duplicates, 1U);
}

TEST(LeaseTable, ALateResultThatIsStillTheFirstCommitsAndFreesTheOther) {
  LeaseTable table = small_table();
  const Lease late = table.grant(kAnn, kStart).value();
  table.remove_worker(kAnn);
  const Lease again = table.grant(kBob, kStart).value();

  const LeaseVerdict verdict = table.result(kAnn, late.id, kRight, kStart);

  EXPECT_EQ(verdict.outcome, ResultOutcome::kCommitted);
  ASSERT_EQ(verdict.cancelled.size(), 1U);
  EXPECT_EQ(verdict.cancelled[0], std::pair(kBob, again));
  EXPECT_EQ(table.held_count(kBob), 0U);
  EXPECT_EQ(table.result(kBob, again.id, kRight, kStart).outcome, ResultOutcome::kDuplicate);
}

// Ann and Bob disagree about a tile, Cyd decides.
TEST(LeaseTable, AThirdWorkerSettlesADispute) {
  for (const bool ann_is_right : {true, false}) {
    LeaseTable table = small_table();
    const Lease late = table.grant(kBob, kStart).value();
    table.remove_worker(kBob);
    table.add_worker(kBob);
    const Lease again = table.grant(kAnn, kStart).value();
    const Lease rest = table.grant(kAnn, kStart).value();
    ASSERT_EQ(again.tile, late.tile);
    static_cast<void>(table.result(kAnn, again.id, ann_is_right ? kRight : kWrong, kStart));
    static_cast<void>(table.result(kAnn, rest.id, kRight, kStart));

    EXPECT_EQ(table.result(kBob, late.id, ann_is_right ? kWrong : kRight, kStart).outcome,
              ResultOutcome::kMismatch);
    EXPECT_FALSE(table.finished());
    EXPECT_EQ(table.grant(kAnn, kStart), std::nullopt);
    EXPECT_EQ(table.grant(kBob, kStart), std::nullopt);
    const Lease third = table.grant(kCyd, kStart).value();
    EXPECT_EQ(third.tile, late.tile);
    EXPECT_EQ(table.result(kCyd, third.id, kRight, kStart).outcome,
              ann_is_right ? ResultOutcome::kDuplicate : ResultOutcome::kReplaced);
    EXPECT_TRUE(table.finished());
    EXPECT_EQ(table.stats().mismatches, 1U);
  }
}

TEST(LeaseTable, ADisputeThatNobodyCanSettleHoldsNothingUp) {
  LeaseTable table = small_table();
  table.remove_worker(kCyd);
  const Lease late = table.grant(kBob, kStart).value();
  table.remove_worker(kBob);
  table.add_worker(kBob);
  static_cast<void>(table.result(kAnn, table.grant(kAnn, kStart)->id, kRight, kStart));
  static_cast<void>(table.result(kAnn, table.grant(kAnn, kStart)->id, kRight, kStart));

  static_cast<void>(table.result(kBob, late.id, kWrong, kStart));

  EXPECT_TRUE(table.finished());
}

TEST(LeaseTable, ATileThatKilledTwoWorkersAloneIsGivenUpAndTheOthersFinish) {
  LeaseTable table{TileGrid{128, 32, 32}, seconds(10), /*seed=*/1};  // four tiles
  constexpr TileId kKiller{0};
  std::size_t committed = 0;
  std::uint32_t victims = 0;
  for (std::uint32_t id = 0; id < 20 && !table.finished(); ++id) {
    const WorkerId worker{id};
    table.add_worker(worker);
    // It may hold two tiles, dies if one of them is the killer, and else renders the first.
    std::vector<Lease> held;
    while (held.size() < 2) {
      const auto lease = table.grant(worker, kStart);
      if (!lease) { break; }
      held.push_back(*lease);
    }
    const auto deadly = [](const Lease& lease) { return lease.tile == kKiller; };
    if (std::any_of(held.begin(), held.end(), deadly)) {
      ++victims;
      const std::vector<TileId> poisoned = table.worker_died(worker);
      EXPECT_EQ(poisoned.size(), victims == 4 ? 1U : 0U);
    } else {
      static_cast<void>(table.result(worker, held.front().id, kRight, kStart));
      ++committed;
      table.remove_worker(worker);
    }
  }

  EXPECT_EQ(victims, 4U);
  EXPECT_EQ(table.poisoned(), std::vector<TileId>{kKiller});
  EXPECT_EQ(committed, 3U);
  EXPECT_TRUE(table.finished());
}

TEST(LeaseTable, AWorkerThatComesBackWasKilledByNoTile) {
  LeaseTable table = small_table();
  for (int round = 0; round < 5; ++round) {
    for (const WorkerId worker : {kAnn, kBob}) {
      ASSERT_NE(table.grant(worker, kStart), std::nullopt);
      EXPECT_TRUE(table.worker_died(worker).empty());
      table.add_worker(worker);
    }
  }
  EXPECT_TRUE(table.poisoned().empty());
}

TEST(LeaseTable, ATileGivenUpForAWorkerThatComesBackIsPendingAgain) {
  LeaseTable table{TileGrid{32, 32, 32}, seconds(10), /*seed=*/1};  // one tile
  for (const WorkerId worker : {kAnn, kBob, kCyd}) {
    table.add_worker(worker);
    ASSERT_NE(table.grant(worker, kStart), std::nullopt);
    static_cast<void>(table.worker_died(worker));
  }
  ASSERT_TRUE(table.finished());

  table.add_worker(kBob);

  EXPECT_FALSE(table.finished());
  EXPECT_EQ(table.grant(kBob, kStart)->tile, TileId{0});
}

TEST(LeaseTable, ThePauseOfTheMasterCountsForNobody) {
  LeaseTable table = small_table();
  static_cast<void>(table.grant(kAnn, kStart));

  table.extend_all(seconds(60));

  EXPECT_TRUE(table.expire(kStart + seconds(69)).empty());
  EXPECT_EQ(table.expire(kStart + seconds(70)).size(), 1U);
}

TEST(LeaseTable, DeadlinesFollowSlowTiles) {
  LeaseTable table = small_table();
  const Lease slow = table.grant(kAnn, kStart).value();
  static_cast<void>(table.result(kAnn, slow.id, kRight, kStart + seconds(9)));

  EXPECT_EQ(table.lease_length(), Duration(seconds(36)));
}

// Ann holds both tiles and has done none for 20 seconds, Bob holds none.
struct LastTiles {
  LeaseTable table = small_table();
  std::vector<Lease> of_ann{};
  Time now = kStart + seconds(20);

  LastTiles() {
    for (int i = 0; i < 2; ++i) { of_ann.push_back(table.grant(kAnn, kStart).value()); }
  }
};

TEST(LeaseTable, NoTileIsTheLastWhileOneIsPending) {
  LeaseTable table = small_table();
  const Lease first = table.grant(kAnn, kStart).value();
  EXPECT_TRUE(table.last_tiles(kStart + seconds(20)).empty());
  static_cast<void>(table.grant(kAnn, kStart));
  EXPECT_EQ(table.last_tiles(kStart + seconds(20)).size(), 2U);
  EXPECT_EQ(table.result(kAnn, first.id, kRight, kStart).outcome, ResultOutcome::kCommitted);
  EXPECT_EQ(table.last_tiles(kStart + seconds(20)).size(), 1U);
}

TEST(LeaseTable, TheFirstOfTwoWithTheSameTileCommitsAndFreesTheOther) {
  LastTiles last;
  const Lease second = last.table.grant_second(kBob, last.of_ann[0].tile, last.now).value();
  EXPECT_EQ(second.tile, last.of_ann[0].tile);
  EXPECT_EQ(last.table.stats().doubled, 1U);

  const LeaseVerdict verdict = last.table.result(kBob, second.id, kRight, last.now);
  EXPECT_EQ(verdict.outcome, ResultOutcome::kCommitted);
  ASSERT_EQ(verdict.cancelled.size(), 1U);
  EXPECT_EQ(verdict.cancelled[0], std::pair(kAnn, last.of_ann[0]));
  EXPECT_EQ(last.table.result(kAnn, last.of_ann[0].id, kRight, last.now).outcome,
            ResultOutcome::kDuplicate);
  EXPECT_EQ(last.table.tiles_committed(), 1U);
}

TEST(LeaseTable, ATileHasAtMostTwoWorkersAndTheyDiffer) {
  LastTiles last;
  const TileId tile = last.of_ann[0].tile;
  EXPECT_EQ(last.table.grant_second(kAnn, tile, last.now), std::nullopt);
  EXPECT_NE(last.table.grant_second(kBob, tile, last.now), std::nullopt);
  EXPECT_EQ(last.table.grant_second(kCyd, tile, last.now), std::nullopt);
  EXPECT_EQ(last.table.last_tiles(last.now), std::vector<TileId>{last.of_ann[1].tile});
}

TEST(LeaseTable, ATileOfTwoWorkersIsPendingOnlyWhenBothAreGone) {
  LastTiles last;
  const TileId tile = last.of_ann[0].tile;
  static_cast<void>(last.table.grant_second(kBob, tile, last.now));
  last.table.remove_worker(kBob);
  EXPECT_EQ(last.table.grant(kCyd, last.now), std::nullopt);
  last.table.remove_worker(kAnn);
  EXPECT_NE(last.table.grant(kCyd, last.now), std::nullopt);
  EXPECT_NE(last.table.grant(kCyd, last.now), std::nullopt);
}

TEST(LeaseTable, WhoWouldBeDoneLaterIsGivenNoSecondLease) {
  LeaseTable table{TileGrid{96, 32, 32}, seconds(10), /*seed=*/1};
  for (const WorkerId worker : {kAnn, kBob}) { table.add_worker(worker); }
  // Bob needs ten seconds for a tile, Ann one.
  const Lease slow = table.grant(kBob, kStart).value();
  const Lease quick = table.grant(kAnn, kStart).value();
  const Lease left = table.grant(kAnn, kStart).value();
  EXPECT_EQ(table.result(kAnn, quick.id, kRight, kStart + seconds(1)).outcome,
            ResultOutcome::kCommitted);
  EXPECT_EQ(table.result(kBob, slow.id, kRight, kStart + seconds(10)).outcome,
            ResultOutcome::kCommitted);
  EXPECT_EQ(table.grant_second(kBob, left.tile, kStart + seconds(2)), std::nullopt);
}

// A million random events: workers come, die, leave, stall, answer late, twice, wrongly addressed.
// In the end every tile was committed exactly once and no lease is with a worker that is not there.
class LeaseTableRandom : public ::testing::TestWithParam<std::uint64_t> {};

TEST_P(LeaseTableRandom, CommitsEveryTileOnceWhateverHappens) {
  SCOPED_TRACE("seed " + std::to_string(GetParam()));
  std::mt19937_64 random{GetParam()};
  const TileGrid grid{32 * 40, 32 * 50, 32};
  LeaseTable table{grid, seconds(10), random()};
  std::map<TileId, int> commits;
  std::set<WorkerId> present;
  std::vector<std::pair<WorkerId, Lease>> issued;  // ever, answered or not
  std::uint32_t workers = 0;
  std::uint64_t events = 0;
  std::uint64_t late = 0;
  Time now{};
  const auto any_worker = [&] {
    return *std::next(present.begin(), static_cast<std::ptrdiff_t>(random() % present.size()));
  };
  const auto answer = [&](std::size_t which) {
    const auto [worker, lease] = issued[which];
    const LeaseVerdict verdict = table.result(worker, lease.id, kRight, now);
    if (verdict.outcome == ResultOutcome::kCommitted) { ++commits[lease.tile]; }
    late += verdict.outcome == ResultOutcome::kDuplicate ? 1U : 0U;
    EXPECT_NE(verdict.outcome, ResultOutcome::kMismatch);
    EXPECT_NE(verdict.outcome, ResultOutcome::kReplaced);
  };

  while (!table.finished() && events < 1'000'000) {
    ++events;
    now += std::chrono::milliseconds(random() % 50);
    const std::uint64_t dice = random() % 1000;
    if (present.size() < 2 || (dice < 2 && present.size() < 12)) {
      present.insert(WorkerId{workers});
      table.add_worker(WorkerId{workers++});
    } else if (dice < 4) {
      const WorkerId leaver = any_worker();
      table.remove_worker(leaver);
      present.erase(leaver);
    } else if (dice < 5) {
      const WorkerId victim = any_worker();
      static_cast<void>(table.worker_died(victim));
      present.erase(victim);
    } else if (dice < 500) {
      const WorkerId worker = any_worker();
      if (table.held_count(worker) < 3) {
        auto lease = table.grant(worker, now);
        if (!lease && random() % 2 == 0) {
          const std::vector<TileId> last = table.last_tiles(now);
          if (!last.empty()) {
            lease = table.grant_second(worker, last[random() % last.size()], now);
          }
        }
        if (lease) { issued.emplace_back(worker, *lease); }
      }
    } else if (dice < 700) {
      table.progress(any_worker(), now);
    } else if (dice < 720) {
      static_cast<void>(table.expire(now));
    } else if (!issued.empty()) {
      // Mostly one of the newest; sometimes any at all, late or again.
      const std::size_t reach =
          dice < 990 ? std::min<std::size_t>(issued.size(), 20) : issued.size();
      answer(issued.size() - 1 - random() % reach);
    }
    if (events % 64 != 0) { continue; }
    for (std::uint32_t worker = 0; worker < workers; ++worker) {
      if (!present.contains(WorkerId{worker})) {
        ASSERT_EQ(table.held_count(WorkerId{worker}), 0U);
      }
    }
  }
  for (std::size_t i = 0; i < issued.size(); ++i) { answer(i); }

  EXPECT_TRUE(table.finished()) << "after " << events << " events";
  EXPECT_EQ(commits.size() + table.poisoned().size(), grid.count());
  EXPECT_EQ(table.tiles_committed(), commits.size());
  for (const auto& [tile, count] : commits) { EXPECT_EQ(count, 1) << index_of(tile); }
  EXPECT_EQ(table.stats().granted, issued.size());
  EXPECT_GT(late, 0U);  // the hard case was reached
}

INSTANTIATE_TEST_SUITE_P(Seeds, LeaseTableRandom, ::testing::Range<std::uint64_t>(1, 41));

}  // namespace
}  // namespace preheat
