import type { Scan } from "../net/api";
import { t } from "../texts/translate";

/** The files of a result that the service has. */
const FILES = [
  ["model", ".json"],
  ["grasps", "-grasps.json"],
  ["cloud", ".ply"],
  ["preview", ".png"],
  ["recording", ".mcap"],
] as const;
type Kind = (typeof FILES)[number][0];

interface ResultFilesProps {
  scan: Scan;
  /** Files that are not offered. */
  except?: readonly Kind[];
}

/** Links that save the files of a scan. The names of the files begin with its id. */
export function ResultFiles({ scan, except = [] }: ResultFilesProps) {
  return (
    <>
      {FILES.map(([kind, ending]) => {
        const address = scan.links[kind];
        if (address === null || except.includes(kind)) return null;
        return (
          <a key={kind} class="button" href={address} download={`${scan.id}${ending}`}>
            {t(`files.${kind}`)}
          </a>
        );
      })}
    </>
  );
}
